"""Step 6, method learned: pieces of the cloud, merged by a trained model of boundaries."""
