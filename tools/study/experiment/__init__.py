"""Studies: runs of rigs with tables and figures."""
