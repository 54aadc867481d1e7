"""From a port to frames of counts: transports, the device behind them, and its clock."""
