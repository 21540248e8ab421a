<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology">
<pipe>
<rasterrenderer type="singlebandpseudocolor" band="1" opacity="0.7" alphaBand="-1" nodataColor="" classificationMin="0" classificationMax="9">
<rastershader><colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" minimumValue="0" maximumValue="9"><item value="0" color="#d7191c" alpha="0" label="0"/><item value="1" color="#d7191c" alpha="200" label="1"/><item value="2" color="#fdae61" alpha="190" label="2"/><item value="4" color="#ffffbf" alpha="180" label="4"/><item value="6" color="#a6d96a" alpha="180" label="6"/><item value="9" color="#1a9641" alpha="180" label="9"/></colorrampshader></rastershader>
</rasterrenderer>
</pipe>
</qgis>
