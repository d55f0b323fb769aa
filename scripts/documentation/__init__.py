"""Documents in docs/ that are made from the declarations in the package."""
