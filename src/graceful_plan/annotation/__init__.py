"""Class, fragility, significance and severity of entities, as a language or vision-language model estimates them."""
