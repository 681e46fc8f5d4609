"""What the published numbers come from: ``python -m studies`` lists the studies."""
