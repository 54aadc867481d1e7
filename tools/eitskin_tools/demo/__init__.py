"""The demonstration in one command: a virtual skin, the runtime, a scanner and a subscriber, each its own process."""
