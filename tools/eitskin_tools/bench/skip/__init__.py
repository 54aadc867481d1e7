"""What each skip of the frame loop saves and what it costs in error; measured by 'eitskin bench skip'."""
