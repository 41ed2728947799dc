"""What is measured of a trained model, each with its figure."""
