"""AutoMove: carries out an order to move with the plugins it loads for it."""
