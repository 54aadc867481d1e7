"""Sample scenes, to be named where a scene's file is asked for."""
