"""What all results share: new folders, pictures and their style."""
