"""Sets of touched units: what they cost, and the ways from one to a better one."""
