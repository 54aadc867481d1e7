"""eitskin: the runtime of a soft electronic skin, without torch."""
