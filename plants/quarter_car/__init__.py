"""A quarter car on a liquid strut with a servovalve, over a sinusoidal road."""
