"""What happens to a frame between the line and the packer, and what may be skipped."""
