"""The same functions as the plain modules with less arithmetic; a test holds each equal to its plain form."""
