"""What touches cost before anything is measured: what each is like, and that what hangs together is one body."""
