"""Study: robots of new users, written with scipy alone, diagnosed from the command line."""
