"""Class, fragility, significance and severity of entities, estimated by a language or vision-language model."""
