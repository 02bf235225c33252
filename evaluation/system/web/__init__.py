"""`pose-eval web`: the operator's page in a browser, held to its bars."""
