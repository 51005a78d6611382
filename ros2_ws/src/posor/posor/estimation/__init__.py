"""From one raw scan to one pose with covariance."""
