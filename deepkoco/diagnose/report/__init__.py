"""A diagnosis as a folder: page, text, figures and the extended model."""
