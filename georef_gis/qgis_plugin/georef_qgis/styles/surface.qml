<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology">
<pipe>
<rasterrenderer type="hillshade" band="1" azimuth="315" angle="45" zfactor="2" multidirection="1" opacity="1" alphaBand="-1" nodataColor=""/>
</pipe>
</qgis>
