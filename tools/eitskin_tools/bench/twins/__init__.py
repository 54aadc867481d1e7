"""What a bundle gains on a device that was calibrated."""
