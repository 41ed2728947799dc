"""From recordings to what a fit compares with: windows and their noise."""
