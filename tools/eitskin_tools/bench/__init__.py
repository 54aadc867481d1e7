"""One folder a benchmark: ``bench`` is what ``eitskin bench NAME`` runs, the rest are its helpers."""
