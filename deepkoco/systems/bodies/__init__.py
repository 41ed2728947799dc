"""The systems that the package knows, one file each."""
