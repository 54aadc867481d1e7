"""The computation of a frame between the line and the packer, and the parts that may be skipped."""
