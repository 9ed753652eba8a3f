"""Gate logs: what a garage's barriers wrote down, the profile that fits it, and the requests that replay it."""
