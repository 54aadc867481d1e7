"""What breaks a skin, and where: sweeps of every disturbance, a module a family, for ``eitskin bench stability``."""
