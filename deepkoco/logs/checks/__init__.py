"""What is checked of a log before it is used."""
