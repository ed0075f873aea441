"""Soft tissue of the knee: skin, fat, fascia, muscles, tendons, cartilage and menisci as closed solids."""
