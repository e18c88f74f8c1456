"""Pictures of scenes and paths. Nothing here is imported by the rest of the library; matplotlib comes in on demand."""
