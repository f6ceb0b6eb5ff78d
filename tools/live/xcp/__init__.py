"""A node as an XCP slave: measured and calibrated with the tools that engineers have."""
