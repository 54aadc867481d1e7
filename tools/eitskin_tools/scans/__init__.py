"""Sample points of a surface, to be named where a file of points is asked for."""
