"""The bridge between an operator's browser and the site: `hmi-client web`."""
