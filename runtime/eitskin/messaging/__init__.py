"""What leaves the process and what comes in: frames, subscriptions, control requests, keys."""
