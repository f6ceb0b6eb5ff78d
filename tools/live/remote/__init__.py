"""`--at HOST:PORT`: running nodes of another machine, by way of a `pcpc host` there."""
