"""A solver that checks the network's answer against physics, plugged into ``eitskin evaluate``."""
