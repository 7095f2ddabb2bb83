"""What judges Cairn: campaigns, evaluations, experiments, batches, benchmarks, mutation tests."""
