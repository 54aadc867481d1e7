"""Flashing a configuration: the exchange of requests, and the procedure that leaves the old or the new one."""
