"""Tables, words, pages, documents and the style of figures."""
