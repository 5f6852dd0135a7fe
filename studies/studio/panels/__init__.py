"""The panel beside the scene, one file a part. Each draws what the session holds and passes on what is typed."""
