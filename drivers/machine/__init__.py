"""The computer under a run: real time, memory, claims, the kernel, the files of others."""
