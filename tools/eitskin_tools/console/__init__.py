"""What people read while a command runs."""
