"""Commands that make a log informative, and the recording of a unit that is driven by them."""
