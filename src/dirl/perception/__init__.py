"""What an image says: features from frozen encoders, and whether two observations show the same place."""
