"""What is done to a laser scan before a detector sees it; `chain` builds it from settings."""
