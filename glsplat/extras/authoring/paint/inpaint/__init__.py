"""What no picture shows of a person: cloth that goes on around the body, and hair that falls behind it."""
