"""From a scanner's points to the ordered cloud, and from the cloud to V_pred."""
