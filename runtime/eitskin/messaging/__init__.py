"""Communication with other processes: frames, subscriptions, control requests, keys."""
