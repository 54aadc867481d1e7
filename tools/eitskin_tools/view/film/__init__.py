"""A recording as something to look at: parts of a second that pages ask for, and an overview of the whole file."""
