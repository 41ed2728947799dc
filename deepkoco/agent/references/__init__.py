"""What a trained controller is compared with at the end of its training, and what to try where it is worse."""
