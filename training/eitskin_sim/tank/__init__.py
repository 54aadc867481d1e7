"""A round tank with sixteen electrodes on its rim, as others measured it: from their numbers to the objects in it."""
