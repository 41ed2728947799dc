"""The command line `deepkoco`: one file for each subcommand."""
