"""VD2T and its layers."""
