"""`pose-eval field`: a site with certificates and rules, under attack, misfortune and change."""
