"""Public measurements of a round tank with sixteen electrodes on its rim: from the voltages to the objects in it."""
