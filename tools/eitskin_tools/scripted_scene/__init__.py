"""A scene that moves: which touches come and go and how the sheet bends meanwhile, solved at keyframes."""
