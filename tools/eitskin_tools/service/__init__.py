"""Running as a service: what a supervisor is told, and what ends a run that stands still."""
