"""The demonstration in one command: a virtual skin, the runtime and a scanner as processes, and a subscriber here."""
