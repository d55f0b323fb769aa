"""From residuals to estimated parameters, their covariance and identifiability."""
