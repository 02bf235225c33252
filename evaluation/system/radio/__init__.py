"""`pose-eval field --radio`: a fleet whose robots share a poor radio link to the site."""
