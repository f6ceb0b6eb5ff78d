"""A rig as one HTML file: its nodes as WebAssembly, with the bits of every other build."""
