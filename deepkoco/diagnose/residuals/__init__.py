"""What a fitted model leaves unexplained, and how it is described."""
