"""The folder of a model: its files, their arrays and its card."""
