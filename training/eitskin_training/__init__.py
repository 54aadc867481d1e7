"""VD2T in torch: the model, its training and its recipes."""
