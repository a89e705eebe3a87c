"""Touch on a patterned skin read from its marks against an untouched reference, without a calibration."""

from palpate.estimators.shear.shear_reader import ShearReader, ShearTouch
from palpate.estimators.shear.skin_marks import TiledSkin
from palpate.estimators.shear.touch_places import TouchPlace, TouchPlaces

__all__ = ["ShearReader", "ShearTouch", "TiledSkin", "TouchPlace", "TouchPlaces"]
