"""A moving scene: touches that come and go on a sheet that bends, solved at keyframes."""
