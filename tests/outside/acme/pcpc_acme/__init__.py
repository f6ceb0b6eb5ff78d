"""What Acme adds to pcpc. Its system, the folder lag/, is written by `pcpc new --bare`."""
