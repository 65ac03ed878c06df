"""Controllers of users in processes of their own, while they are scored."""
