"""From changes of voltage to maps: the bundle, its engines and its gate."""
