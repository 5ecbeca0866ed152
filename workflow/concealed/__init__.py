"""The proof: concealed effects, diagnosed from recordings alone, sealed, opened and scored."""
