"""Predictions of what nobody has measured yet: layouts and muscle types predicted before they are sewn
(docs/unseen.md). Belongs here: what draws models from a joint covariance."""
