"""What training sees: batches with noise, missing rows and mirror images, made when they are needed."""
