"""Electronics of other makers: what a driver says and gives, those that are shipped, and the line that runs one."""
