"""A sample scan, to be named where a scan's file is asked for."""
