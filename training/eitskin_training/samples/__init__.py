"""Training samples: batches with noise, missing rows and mirror images, made on demand."""
