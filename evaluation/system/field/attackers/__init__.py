"""Who attacks a site: what members try, strangers, and what routers say of them."""
