"""What a bundle's gate finds of faint presses."""
