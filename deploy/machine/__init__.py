"""A machine of the site: installing a bundle, and checking what is installed."""
