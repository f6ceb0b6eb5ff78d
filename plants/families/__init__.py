"""What systems of one family share: a model's parts, laws, drawings."""
