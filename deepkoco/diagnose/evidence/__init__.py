"""Selection of causes: screening, fits, ranking, classes, forward selection and elimination."""
