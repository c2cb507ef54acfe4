"""Commands that check and describe models, such as validate, rules and conformance."""
