"""Published studies, each reproduced by one file; `scripts/reproduce` runs them."""
