"""The figures of a report, each with the table behind it."""
