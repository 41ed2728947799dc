"""What a trained latent model has learned: measures with figures, and their page."""
