"""What this machine offers: doctor, jitter, a kernel with vcan."""
