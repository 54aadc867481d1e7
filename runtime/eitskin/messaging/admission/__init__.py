"""Who gets in: connections to a bound socket, as many as there is room for, and none that costs somebody else's."""
