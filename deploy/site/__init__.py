"""The site's keeper: names, certificates, rules, bundles."""
