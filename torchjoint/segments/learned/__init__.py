"""Step 6, method learned: superpoints of the cloud, merged by a trained model of boundaries."""
