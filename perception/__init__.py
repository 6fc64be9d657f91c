"""From pictures to a `State`: where the wrist camera looks, what is what, and where it stands, with a covariance."""
