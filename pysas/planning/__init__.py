"""From a survey, a grid and budgets of error to what a sum needs: bounds, costs, choices, layouts, trees."""
