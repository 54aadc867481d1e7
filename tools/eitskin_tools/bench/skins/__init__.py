"""How many skins a machine carries."""
