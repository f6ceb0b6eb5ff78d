"""Drives of robots on CAN: their dialects, as the compiled loop speaks them."""
