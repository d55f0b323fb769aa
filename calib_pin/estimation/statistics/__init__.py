"""Statistics of the residuals: distributions, variance components, repeated rows."""
