"""What training sees: batches with noise, lost rows and mirror images, made when they are needed."""
