"""Running as a service: messages to the supervisor, and the watchdog that ends a hung run."""
