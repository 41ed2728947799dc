"""Which causes explain the data: screened, fitted, ranked and selected."""
