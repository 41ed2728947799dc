"""When everything happens: from rates and delays, drawn or recorded, to a computation graph."""
