"""Recorded frames computed once more: by what was running, or by another bundle or solver."""
