"""What users ask about states and motions."""
